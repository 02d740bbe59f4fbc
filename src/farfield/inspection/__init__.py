"""What a data set holds, what is wrong with it, and how like another it is."""
