"""Networks that no library packages, written here."""
