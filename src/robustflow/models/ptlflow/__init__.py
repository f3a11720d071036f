"""Networks of the library ptlflow as flow models."""
