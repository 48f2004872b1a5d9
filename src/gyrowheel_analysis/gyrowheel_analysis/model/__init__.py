"""What the analyst believes: a bench, what recordings have taught about it, and the effects added; as a file, too."""

from gyrowheel_analysis.model.model import Model, Override

__all__ = ["Model", "Override"]
