"""The fastest move of fingers that hold nothing."""
