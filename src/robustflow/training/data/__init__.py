"""The input of a training run: find and mix datasets, in an order that is a function of the step."""
