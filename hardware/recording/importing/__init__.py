"""Files of other programs become recordings: their arrays, frames and labels."""
