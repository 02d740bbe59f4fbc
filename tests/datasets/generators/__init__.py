"""Small trees of other people's formats, written from the published schemas alone, with the truth beside them.

Whoever writes here has not seen the readers. One module a format; ``scene`` is the little world that all of them show,
``truth`` what has to come out.
"""
