"""Flying shapes: any number of generated pairs with exact flow and occlusion."""
