"""`robustflow app`: corrupt a pair and see a model's flow. The page is served on and for this machine."""
