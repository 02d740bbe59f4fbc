"""What a car's sensors measure as they run: each at its own moments, by a clock of its own."""
