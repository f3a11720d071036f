"""The input of a training: data sets found and mixed, in an order that is a function of the step."""
