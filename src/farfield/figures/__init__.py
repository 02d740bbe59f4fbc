"""Figures by matplotlib, tables and words of results: plain data in, pictures and rows out."""
