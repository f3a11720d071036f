"""Names and parameters of the five corruptions that need the whole clip; `robustflow.video` implements them."""
