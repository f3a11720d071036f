"""Networks from the ptlflow library as flow models."""
