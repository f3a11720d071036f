"""`robustflow app`: a local web page to corrupt a pair and see a model's flow."""
