"""The paper's weather and optics in three dimensions: corruptions that need the depth of the scene."""
