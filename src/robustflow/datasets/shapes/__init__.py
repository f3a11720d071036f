"""Flying shapes: pairs generated from numbers alone, with exact flow and occlusion, as many as needed."""
