"""Building blocks shared by several networks. Every module here requires the torch extra."""
