"""`robustflow app`: corrupt a pair, see what a model makes of it. A web page of this machine for this machine."""
