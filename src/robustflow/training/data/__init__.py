"""The input of a training run: find datasets and mix them in an order that is a function of the step."""
