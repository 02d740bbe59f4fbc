"""The studio: view, annotate and infer in the browser; its page stands in ``web/`` and ships as ``static/``."""
