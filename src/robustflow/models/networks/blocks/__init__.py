"""Building blocks that several networks truly share. Every module here needs the torch extra."""
