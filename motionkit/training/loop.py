"""The training loop: deterministic in (seed, step), exactly resumable, safe to interrupt; and files of tensors.

A step's randomness comes from its generator, which depends on (seed, purpose, step) alone. The step number and the
tensors of `Trainable.state_tensors` are the whole state of a training, so an interrupted and resumed run is bitwise
equal to an uninterrupted one. With a budget of processor time it is measured first how many steps fit.

Tensors are in safetensors files with a JSON description; of other people's checkpoints no pickle is executed.
"""

import hashlib
import json
import signal
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from motionkit.core.errors import DamagedFileError, MotionkitError, UsageError
from motionkit.core.files import sync, whole_file, write_json
from motionkit.core.progress import OnProgress, ignore, task
from motionkit.training.networks import ALONE, Ranks, resolve_device
from motionkit.training.run import HINT, Began, RunError, StageContext, StageFolder, check_recorded, clear_stage

# Measured steps are spread evenly over the training, since early ones may cost less; rounds are repeated until this
# share of the budget is spent.
ROUND, MEASURED_SHARE = 16, 0.02
FEWEST_STEPS = 10


@runtime_checkable
class Trainable(Protocol):
    """What `train_loop` trains.

    With several ranks each has some rows of the batch; gradients are reduced inside `step`, metrics by the loop. A
    budget of processor time sets `steps` before training.
    """

    steps: int

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """Do one whole step (batch, loss, optimiser) and return its metrics, this rank's share of them, as scalars.

        `step` counts from 0; all randomness comes from `generator` (on the CPU, the same on every rank).
        """

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """The complete training state: weights, optimiser moments, averages; complete on the first rank."""

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_tensors` returned."""


def run_training(context: StageContext, training: Trainable, folder: StageFolder) -> dict[str, float]:
    """Run a stage's steps, as many as the budget allows if there is one.

    Returns the figures of `train_loop`; errors as there and in `plan_steps`.
    """
    if context.budget_seconds is not None:
        if context.ranks.size > 1:
            raise UsageError("--budget is for one process: a rank does not know what the others have spent")
        clock = seconds_spent(resolve_device(context.device), context.began)
        plan_steps(training, folder, context.budget_seconds, context.seed, clock)
    return train_loop(training, folder, seed=context.seed, ranks=context.ranks, on_progress=context.on_progress)


def train_loop(
    trainable: Trainable,
    folder: StageFolder,
    *,
    seed: int,
    log_every: int = 50,
    checkpoint_seconds: float = 60.0,
    ranks: Ranks = ALONE,
    on_progress: OnProgress = ignore,
) -> dict[str, float]:
    """Train all steps, from the folder's checkpoint if there is one.

    Returns the last logged metrics, and `cpu_seconds`, including earlier sessions.

    Metrics are means over the steps since the last line of metrics.jsonl, or since the training was resumed. A
    checkpoint is saved with a line, `checkpoint_seconds` after the last one. Ctrl-C or SIGTERM ends the current step,
    saves a checkpoint and raises `KeyboardInterrupt`. Raises `RunError` for a non-finite loss (the last checkpoint is
    kept), `CheckpointError` for a checkpoint of another training, and `DamagedFileError` if it or the log is damaged.
    Only the first rank writes, and only it has the metrics.
    """
    purpose, steps, spent = folder.path.name, trainable.steps, time.process_time()
    first, before = _restore(trainable, folder, ranks)
    latest = (folder.read_metrics() or [{}])[-1]
    saved = time.perf_counter()
    started = saved - latest.get("seconds", 0.0)
    sums: dict[str, torch.Tensor] = {}
    logged = first
    report = on_progress if ranks.is_first else ignore
    with task(report, purpose, steps, done=first) as work, _interrupts() as interrupted:
        for step in range(first, steps):
            for name, value in trainable.step(step, step_generator(seed, purpose, step)).items():
                # Sums stay on the device, to avoid synchronisation.
                sums[name] = sums[name] + value.detach().double() if name in sums else value.detach().double()
            done = step + 1
            stop, due = ranks.agree(interrupted.is_set(), time.perf_counter() - saved > checkpoint_seconds)
            if done % log_every == 0 or done == steps or stop:
                means = _means(sums, done - logged, ranks, f"{folder.path}, steps {logged + 1} to {done}")
                sums, logged = {}, done
                latest = {"step": float(done), "seconds": round(time.perf_counter() - started, 3)} | means
                work.note(" ".join(f"{name} {latest[name]:.4g}" for name in list(latest)[2:5]))
                if ranks.is_first:
                    folder.append_metrics(latest)
                if due or stop or done == steps:
                    _save(trainable, folder, ranks, done, before + time.process_time() - spent)
                    saved = time.perf_counter()
            if stop:
                raise KeyboardInterrupt
            work.advance()
    return latest | {"cpu_seconds": round(before + time.process_time() - spent, 1)}


def _means(sums: Mapping[str, torch.Tensor], count: int, ranks: Ranks, where: str) -> dict[str, float]:
    """Means of metrics over `count` steps of all ranks; raises `RunError` on all ranks if one is not finite."""
    totals = torch.stack(list(sums.values())).cpu()
    ranks.add_up([totals])
    for name, total in zip(sums, totals, strict=True):
        if not torch.isfinite(total):
            raise RunError(f"{where}: {name} is not finite; use a lower learning rate (an earlier checkpoint is kept)")
    return {name: float(total) / count for name, total in zip(sums, totals, strict=True)}


def _save(trainable: Trainable, folder: StageFolder, ranks: Ranks, done: int, cpu_seconds: float) -> None:
    tensors = prefixed("state", trainable.state_tensors())
    if ranks.is_first:
        sync(folder.metrics_path)  # so that no checkpoint is ahead of it
        description = {"step": done, "stage": folder.path.name, "cpu_seconds": round(cpu_seconds, 1)}
        save_tensors(folder.checkpoint_path, tensors, description)


def _restore(trainable: Trainable, folder: StageFolder, ranks: Ranks) -> tuple[int, float]:
    """Restore the checkpoint, if there is one; returns its step, and the CPU seconds spent until then."""
    path = folder.checkpoint_path
    if not path.is_file():
        ranks.on_first(lambda: folder.keep_metrics(0))
        return 0, 0.0
    tensors, description = load_tensors(path)
    try:
        if description["stage"] != folder.path.name:
            raise ValueError(f"it is of stage {description['stage']!r}")
        step = int(description["step"])
        if not 0 <= step <= trainable.steps:
            raise ValueError(f"it is of step {step:,} of {trainable.steps:,}")
        trainable.load_state_tensors(unprefixed("state", tensors))
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise CheckpointError(
            f"{path} does not fit these settings or this version ({one_line(error)}): {HINT}"
        ) from None
    ranks.on_first(lambda: folder.keep_metrics(step))
    return step, float(description.get("cpu_seconds", 0.0))


@contextmanager
def _interrupts() -> Iterator[threading.Event]:
    """An event set by the first Ctrl-C or SIGTERM; a second one stops at once.

    SIGTERM is what schedulers and torchrun send before they kill. Outside the main thread nothing is caught.
    """
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    def handle(_signal: int, _frame: object) -> None:
        event.set()
        restore()

    for number in previous:
        signal.signal(number, handle)
    try:
        yield event
    finally:
        restore()


def plan_steps(
    trainable: Trainable, folder: StageFolder, budget_seconds: float, seed: int, clock: Callable[[], float]
) -> None:
    """Set a training's number of steps to what fits into its budget, and write it to budget.json.

    An existing budget.json is reused, so a resumed training has the same number of steps; summary.json has it too.
    The training's state is restored. `clock` counts from the stage's start, so what preceded the loop is subtracted.
    Raises `UsageError` if fewer than `FEWEST_STEPS` fit, and `DamagedFileError`.
    """
    if folder.budget_path.is_file():
        trainable.steps = folder.read_budget()["steps"]
        return
    purpose, state = folder.path.name, {name: tensor.clone() for name, tensor in trainable.state_tensors().items()}
    started, count = clock(), 0
    trainable.step(0, step_generator(seed, purpose, 0))  # warm-up
    warm = clock()
    while count == 0 or clock() - started < MEASURED_SHARE * budget_seconds:
        for number in range(ROUND):
            step = (2 * number + 1) * trainable.steps // (2 * ROUND)
            trainable.step(step, step_generator(seed, purpose, step))
        count += ROUND
    ended = clock()
    trainable.load_state_tensors(state)
    seconds_a_step = (ended - warm) / count
    steps = int((budget_seconds - ended) / max(seconds_a_step, 1e-9))
    if steps < FEWEST_STEPS:
        clear_stage(folder)
        folder.config_path.unlink()  # so that the stage counts as not begun
        raise UsageError(
            f"{purpose}: {budget_seconds:.3g} s of processor time are {max(steps, 0)} steps of {seconds_a_step:.3g} s; "
            f"give a larger --budget"
        )
    plan = {
        "budget_seconds": budget_seconds,
        "steps": steps,
        "preparing_seconds": round(started, 3),
        "measured_seconds_a_step": round(seconds_a_step, 6),
        "measuring_seconds": round(ended - started, 3),
    }
    write_json(folder.budget_path, plan)
    trainable.steps = steps


def seconds_spent(device: torch.device, began: Began) -> Callable[[], float]:
    """The clock of a budget: this process' CPU time since `began`; wall time for a GPU."""
    if device.type != "cuda":
        return lambda: time.process_time() - began.cpu_seconds

    def passed() -> float:
        torch.cuda.synchronize(device)
        return time.perf_counter() - began.wall_seconds

    return passed


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


class Learner:
    """A network with its optimiser and, with a decay above 0, the average of its weights: the state of a training.

    The average is exponential, and of parameters; buffers are copied. Its decay ramps up as min(decay, (1 + n) /
    (10 + n)) over steps n, so that early averages forget the start.
    """

    def __init__(
        self, network: torch.nn.Module, optimizer: torch.optim.Optimizer, ema_decay: float = 0.0, ranks: Ranks = ALONE
    ) -> None:
        self.network, self.optimizer, self.ema_decay, self.ranks = network, optimizer, ema_decay, ranks
        weights = network.state_dict() if ema_decay else {}
        self.averages = {name: tensor.detach().clone() for name, tensor in weights.items()}

    def descend(self, loss: torch.Tensor, step: int, rate: float, clip_norm: float = 0.0) -> None:
        """One optimiser step on gradients of all ranks; `clip_norm` above 0 limits their norm.

        A parameter group's learning rate is `rate`, times its "relative_rate" if it has one.
        """
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group.get("relative_rate", 1.0)
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        # A parameter without a gradient has none on any rank, since all build the same graph.
        self.ranks.add_up(each.grad for each in self.network.parameters() if each.grad is not None)
        if clip_norm:
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), clip_norm)
        self.optimizer.step()
        if self.averages:
            self._average(step)

    @torch.no_grad()
    def _average(self, step: int) -> None:
        weight = 1.0 - min(self.ema_decay, (1.0 + step) / (10.0 + step))
        for name, tensor in self.network.state_dict().items():
            if tensor.is_floating_point():
                self.averages[name].lerp_(tensor, weight)
            else:
                self.averages[name].copy_(tensor)

    def trained_tensors(self) -> dict[str, torch.Tensor]:
        """The weights to save: averaged if an average is kept."""
        return self.averages or self.network.state_dict()

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """Weights, the optimiser's moments and step counts, the average."""
        moments = {
            f"{index}.{name}": torch.as_tensor(value)
            for index, state in self.optimizer.state_dict()["state"].items()
            for name, value in state.items()
        }
        return (
            prefixed("network", self.network.state_dict())
            | prefixed("optimizer", moments)
            | prefixed("average", self.averages)
        )

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_tensors` returned."""
        self.network.load_state_dict(unprefixed("network", tensors))
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, tensor in unprefixed("optimizer", tensors).items():
            index, _, key = name.partition(".")
            state.setdefault(int(index), {})[key] = tensor
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": state, "param_groups": groups})
        for name, average in self.averages.items():
            average.copy_(tensors[f"average.{name}"])


def _state(seed: int, purpose: str, step: int) -> int:
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()), step))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def step_generator(seed: int, purpose: str, step: int = 0) -> torch.Generator:
    """A CPU generator for one step of one purpose; drawing on the CPU gives every device the same numbers."""
    return torch.Generator().manual_seed(_state(seed, purpose, step))


@contextmanager
def seeded_initialisation(seed: int, purpose: str) -> Iterator[None]:
    """Initialise modules inside from (seed, purpose); torch's global generator is restored."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(_state(seed, purpose, 0))
        yield


@contextmanager
def dropout_from(generator: torch.Generator, device: torch.device, rank: int = 0) -> Iterator[None]:
    """Seed dropout inside by the generator and the rank; torch's global generators are restored."""
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(int(torch.randint(2**62, (), generator=generator)) + rank)
        yield


DESCRIPTION = "description"


class CheckpointError(MotionkitError):
    """A checkpoint that is missing or belongs to another model."""


def save_tensors(path: Path, tensors: Mapping[str, torch.Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors and a JSON description into one file, as `whole_file` does.

    The description is in the safetensors header, so that tensors and their meaning cannot diverge.
    """
    # Clones, since safetensors refuses tensors that share memory.
    own = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    text = json.dumps(dict(description), allow_nan=False)
    with whole_file(path) as temporary:
        try:
            save_file(own, temporary, metadata={DESCRIPTION: text})
        except SafetensorError as error:
            raise OSError(f"{path} cannot be written ({error})") from None


def load_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read a file of `save_tensors`: tensors on the CPU, float16 as float32, and the description.

    Raises `CheckpointError` for a missing file, and `DamagedFileError` for one that is not whole, or not what its
    folder's record of sha256 says.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such checkpoint")
    check_recorded(path)
    try:
        with safe_open(path, framework="pt") as opened:
            description = json.loads((opened.metadata() or {}).get(DESCRIPTION, "{}"))
            if not isinstance(description, dict):
                raise ValueError("the description in its header is no JSON object")
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
            return {name: t.float() if t.dtype == torch.float16 else t for name, t in tensors.items()}, description
    except (SafetensorError, ValueError, RecursionError) as error:
        raise DamagedFileError(path, one_line(error), HINT) from None


def one_line(error: Exception) -> str:
    """An error's message, shortened to one line."""
    said = " ".join(str(error).split()) or type(error).__name__
    return said if len(said) <= 200 else f"{said[:200]} …"


@contextmanager
def rebuilding(path: Path, stage: str) -> Iterator[None]:
    """Context for building a stage's network from the result of `load_tensors` on `path`.

    Raises `CheckpointError` for missing tensors, others, or other settings.
    """
    try:
        yield
    except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError, UsageError) as error:
        raise CheckpointError(
            f"{path}: not a {stage} of this version of motionkit ({one_line(error)}); train it again "
            f"(motionkit train --stage {stage} --overwrite)"
        ) from None


def prefixed(prefix: str, tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The same tensors under `prefix.name`."""
    return {f"{prefix}.{name}": tensor for name, tensor in tensors.items()}


def unprefixed(prefix: str, tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Those tensors whose name starts with `prefix.`, without it."""
    start = f"{prefix}."
    return {name.removeprefix(start): tensor for name, tensor in tensors.items() if name.startswith(start)}


def read_foreign(path: Path) -> dict[str, Any]:
    """The content of a PyTorch checkpoint by name, tensors on the CPU.

    Raises `CheckpointError` for a file that is missing, damaged, or would execute code (`weights_only=True` refuses).
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such file")
    try:
        loaded: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        # torch raises half a dozen classes for damaged, foreign and forbidden content.
        fault = f"not a checkpoint that can be read without running its pickle ({one_line(error)})"
        raise CheckpointError(f"{path}: {fault}") from None
    return {str(name): value for name, value in loaded.items()} if isinstance(loaded, dict) else {}


def foreign_tensors(loaded: Mapping[str, Any], key: str, path: Path, what: str) -> dict[str, torch.Tensor]:
    """The named tensors under one key of a checkpoint; raises `CheckpointError` if there are none."""
    tensors = loaded.get(key)
    if not isinstance(tensors, dict) or not all(isinstance(tensor, torch.Tensor) for tensor in tensors.values()):
        raise CheckpointError(f"{path}: not {what}, whose checkpoint has its tensors under the key {key!r}")
    return {str(name): tensor for name, tensor in tensors.items()}


def fill_checked(
    own: Mapping[str, torch.Tensor], published: Mapping[str, torch.Tensor], key: str, path: Path, what: str
) -> None:
    """Copy `published` into `own`, in place, after checking names, shapes and finiteness.

    Raises `CheckpointError` that names the tensor, and what was expected; nothing is copied then.
    """
    missing, unknown = sorted(own.keys() - published.keys()), sorted(published.keys() - own.keys())
    if missing or unknown:
        fault = f"lacks {key}/{missing[0]}" if missing else f"has {key}/{unknown[0]} besides"
        raise CheckpointError(f"{path}: not {what} of {len(own)} tensors: it {fault}")
    for name, tensor in own.items():
        if tensor.shape != published[name].shape:
            raise CheckpointError(
                f"{path}: {key}/{name} is {tuple(published[name].shape)}, expected {tuple(tensor.shape)}"
            )
        if not bool(torch.isfinite(published[name]).all()):
            raise CheckpointError(f"{path}: {key}/{name} holds numbers that are not finite")
    with torch.no_grad():
        for name, tensor in own.items():
            tensor.copy_(published[name])


def weights_digest(terms: str, tensors: Mapping[str, torch.Tensor]) -> str:
    """First 16 hex digits of the sha256 over settings and weights, independent of the weights' order."""
    digest = hashlib.sha256(terms.encode())
    for name in sorted(tensors):
        digest.update(name.encode() + np.ascontiguousarray(tensors[name].numpy(), dtype="<f4").tobytes())
    return digest.hexdigest()[:16]
