"""Names and published facts that rooms share which do not import each other, one module a subject."""
