"""Detection metrics in numpy. One protocol is one file."""
