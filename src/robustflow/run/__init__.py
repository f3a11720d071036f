"""Plan and measure; a folder of rows."""
