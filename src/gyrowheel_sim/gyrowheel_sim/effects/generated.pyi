"""Interface of the code that `gyrowheel_sim.effects.law_code` generates for the kernel of the plant."""

from typing import Any

from gyrowheel_sim.effects.law_code import Action, Instant

LAW_MEMORY: int  # where in the state of the plant the states of the effects begin

def law_states(state: Any) -> int:
    """Return their number; their rates and values in the middle of a sample follow, and whether they have begun."""

def remembers(active: Any) -> bool:
    """Whether an active effect has a state."""

def flexures_remember(active: Any) -> bool:
    """Whether an active effect has a state for each flexure."""

def law_rates(coef: Any, active: Any, state: Any, q: Instant) -> None:
    """Write the rates of the states of the active effects into `state`, after the states."""

def law_starts(coef: Any, active: Any, state: Any, q: Instant) -> None:
    """Write the start values of the states of the active effects into `state`."""

def evaluate_laws(coef: Any, active: Any, state: Any, q: Instant) -> Any:
    """Return the sum of the laws of each target, of all active effects, at an instant: fields named as the outputs."""

def evaluate_samples(coef: Any, active: Any, state: Any, q: Instant) -> Any:
    """Return the same of the targets that are evaluated once a sample."""

def hold_samples(state: Any, laws: Any) -> None:
    """Store the outputs of `evaluate_samples` until the next sample."""

def acting(laws: Any) -> Action:
    """Return the action of the laws on the motion."""

def changed(p: Any, laws: Any, state: Any) -> Any:
    """Return the bench parameters as the laws change them at an instant."""

def changed_at_sample(p: Any, state: Any) -> Any:
    """Return the bench parameters as the laws of the last sample change them."""

def lag_of_coils(state: Any) -> float:
    """Return the time constant with which the torque of the coils follows their voltage [s]."""

def reading_errors(laws: Any) -> Any:
    """Return the errors of the readings by the outputs of `evaluate_samples`: one field a reading."""
