"""Pure facts that every room may use: classes, conditions, sequences, regions, published figures."""
