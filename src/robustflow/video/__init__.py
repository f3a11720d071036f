"""The video half: from high-frame-rate clips to key-frame pairs, and the corruptions that need the whole clip."""
