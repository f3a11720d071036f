"""Turn high-frame-rate clips into pairs of key frames, and apply the corruptions that require an entire clip."""
