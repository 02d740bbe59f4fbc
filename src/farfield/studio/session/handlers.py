"""Which function answers which message."""

from farfield.studio.messages import requests as asked
from farfield.studio.session import detecting, exporting, looking
from farfield.studio.session.desk import Handler

HANDLERS: dict[type, Handler] = {
    asked.FrameOpen: looking.open_frame,
    asked.Preview: looking.preview,
    asked.BookmarkSet: looking.bookmark,
    asked.InferStart: detecting.infer,
    asked.InferCancel: detecting.cancel,
    asked.Export: exporting.export,
}
