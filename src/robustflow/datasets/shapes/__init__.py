"""Flying shapes: pairs made from numbers alone, with exact flow and occlusion, as many as one asks for."""
