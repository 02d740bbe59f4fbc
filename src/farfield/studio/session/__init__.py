"""What windows ask of the open data set, and what they are answered."""
