"""Pictures, all in the one style of `style`: each function returns a figure; `figure.write_figure` writes it."""
