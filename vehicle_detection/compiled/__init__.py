"""What is fast: HOG, sums over windows, threads."""
