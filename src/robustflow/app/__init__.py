"""`robustflow app`: corrupt a pair and see a model's flow. A web page served on this machine for this machine."""
