"""Read and write images, and render flow, depth and errors as colours."""
