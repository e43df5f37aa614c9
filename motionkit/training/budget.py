"""Trainings that end when their processor time is spent: at the start it is measured how many steps fit, and kept."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Protocol, runtime_checkable

import torch

from motionkit.core.errors import DamagedFileError, UsageError
from motionkit.core.files import write_json
from motionkit.training.loop import Trainable
from motionkit.training.run import HINT, StageFolder, abandon_stage
from motionkit.training.schedule import step_generator

# Measured steps are spread evenly over the training, since early ones may cost less; rounds are repeated until this
# share of the budget is spent.
ROUND, MEASURED_SHARE = 16, 0.02
FEWEST_STEPS = 10


@runtime_checkable
class Rescheduled(Trainable, Protocol):
    """A `Trainable` whose number of steps can be set before training."""

    steps: int


@dataclass(frozen=True)
class Plan:
    """The number of steps that fit into a budget, with the measured cost of a step and of measuring."""

    budget_seconds: float
    steps: int
    measured_seconds_a_step: float
    measuring_seconds: float


def plan_steps(
    trainable: Rescheduled, folder: StageFolder, budget_seconds: float, seed: int, clock: Callable[[], float]
) -> None:
    """Set a training's number of steps to what fits into its budget, and write it to budget.json.

    An existing budget.json is reused, so a resumed training has the same number of steps; summary.json has it too.
    The training's state is restored. Raises `UsageError` if fewer than `FEWEST_STEPS` fit, and `DamagedFileError`.
    """
    if folder.budget_path.is_file():
        found = folder.read_budget()
        if "steps" not in found:
            raise DamagedFileError(folder.budget_path, "it says no number of steps", HINT)
        trainable.steps = int(found["steps"])
        return
    plan = _measured(trainable, folder.path.name, budget_seconds, seed, clock)
    if plan.steps < FEWEST_STEPS:
        abandon_stage(folder)
        raise UsageError(
            f"{folder.path.name}: {budget_seconds:.3g} s of processor time are {max(plan.steps, 0)} steps of "
            f"{plan.measured_seconds_a_step:.3g} s; give a larger --budget"
        )
    write_json(folder.budget_path, asdict(plan))
    trainable.steps = plan.steps


def _measured(
    trainable: Rescheduled, purpose: str, budget_seconds: float, seed: int, clock: Callable[[], float]
) -> Plan:
    state = {name: tensor.clone() for name, tensor in trainable.state_tensors().items()}
    asked = trainable.steps
    begun = clock()
    trainable.step(0, step_generator(seed, purpose, 0))  # warm-up
    first, count = clock(), 0
    while count == 0 or clock() - begun < MEASURED_SHARE * budget_seconds:
        for number in range(ROUND):
            step = (2 * number + 1) * asked // (2 * ROUND)
            trainable.step(step, step_generator(seed, purpose, step))
        count += ROUND
    ended = clock()
    trainable.load_state_tensors(state)
    each = (ended - first) / count
    left = budget_seconds - (ended - begun)
    return Plan(budget_seconds, int(left / max(each, 1e-9)), round(each, 6), round(ended - begun, 3))


@contextmanager
def one_thread() -> Iterator[None]:
    """Have torch compute on one thread: processor time then is the same training on any number of processors.

    Threads that wait for one another spend it too, several times the work's on a busy machine.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def seconds_spent(device: torch.device) -> Callable[[], float]:
    """The clock of a budget: this process' CPU time; wall time for a GPU."""
    if device.type != "cuda":
        return time.process_time

    def passed() -> float:
        torch.cuda.synchronize(device)
        return time.perf_counter()

    return passed
