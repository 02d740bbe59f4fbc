"""Which function answers which message."""

from farfield.studio.messages import requests as asked
from farfield.studio.session import calibrating, detecting, editing, exporting, viewing
from farfield.studio.session.session import Handler

HANDLERS: dict[type, Handler] = {
    asked.FrameOpen: viewing.open_frame,
    asked.Preview: viewing.preview,
    asked.BookmarkSet: viewing.bookmark,
    asked.InferStart: detecting.infer,
    asked.InferCancel: detecting.cancel,
    asked.Export: exporting.export,
    asked.BoxSet: editing.edit,
    asked.BoxAdd: editing.edit,
    asked.BoxDelete: editing.edit,
    asked.TrackSet: editing.edit,
    asked.TrackMerge: editing.edit,
    asked.TrackSplit: editing.edit,
    asked.TrackInterpolate: editing.edit,
    asked.TrackPropagate: editing.edit,
    asked.Undo: editing.undo,
    asked.Redo: editing.undo,
    asked.Fit: editing.fit,
    asked.CheckList: editing.check_list,
    asked.CheckIgnore: editing.check_ignore,
    asked.Save: editing.save,
    asked.PolicySet: editing.policy,
    asked.Timing: editing.timing,
    asked.MatchList: viewing.match_list,
    **calibrating.HANDLERS,
}
