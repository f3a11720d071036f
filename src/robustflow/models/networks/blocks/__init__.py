"""Building blocks shared by several networks. All modules in this package require the torch extra."""
