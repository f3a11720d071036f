"""Read and write pictures, and render flow, depth and errors as colours."""
