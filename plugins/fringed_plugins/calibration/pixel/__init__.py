"""What holds for each camera pixel by itself: how well its points are known, and models of a pixel's own."""
