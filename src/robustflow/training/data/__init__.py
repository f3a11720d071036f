"""The input of a training run: find and mix data sets, in an order that is a function of the step."""
