"""stub"""
def run() -> int:
    """List."""
    return 0
