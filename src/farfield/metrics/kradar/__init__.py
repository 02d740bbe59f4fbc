"""K-Radar's average precision, as published, as its kit computes it, and corrected."""
