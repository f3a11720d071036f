"""The "depth" family of corruptions: depth-based 3D versions of the paper's weather and optical corruptions."""
