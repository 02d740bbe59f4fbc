"""Figures, tables and one self-contained HTML page. Plain data in; no detector, no network."""
