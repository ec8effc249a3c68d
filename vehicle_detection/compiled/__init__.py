"""What is fast: HOG, sums over windows; threads, processes, and machine code that is kept."""
