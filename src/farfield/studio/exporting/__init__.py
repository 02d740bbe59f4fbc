"""What a person takes away: pictures, films of them, one HTML file that opens from disk."""
