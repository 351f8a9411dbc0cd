"""Where simulation and measurement disagree: name the missing effect and add it to the model."""
