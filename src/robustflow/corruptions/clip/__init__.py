"""Names and parameters of the five corruptions that require an entire clip; `robustflow.data.video` implements them."""
