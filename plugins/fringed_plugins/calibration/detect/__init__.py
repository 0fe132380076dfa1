"""Boards in pictures: their points to a hundredth of a pixel, and why there are none."""
