"""Read and write flow files, depth maps and images."""
