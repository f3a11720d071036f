"""What a training is fed: data sets found and mixed, in an order that is a function of the step."""
