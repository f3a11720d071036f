"""Networks that nobody packages, written here."""
