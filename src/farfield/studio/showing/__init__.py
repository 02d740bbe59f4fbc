"""What a frame shows: layers as bytes, boxes as rows, predictions matched with the truth."""
