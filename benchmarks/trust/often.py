"""motionkit whose trainings save several times a second: `python -m benchmarks.trust.often train …`."""

from motionkit.cli.app import main
from motionkit.training.loop import train_loop

SECONDS = 0.1

if __name__ == "__main__":
    assert train_loop.__kwdefaults__ is not None
    train_loop.__kwdefaults__["checkpoint_seconds"] = SECONDS
    main()
