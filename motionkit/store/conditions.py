"""SQL conditions on the sequences of a store, put together."""


def conjunction(*conditions: str | None) -> str:
    """The condition that all of those given (neither None nor empty) make together; empty where there is none."""
    given = [condition for condition in conditions if condition]
    return given[0] if len(given) == 1 else " AND ".join(f"({condition})" for condition in given)
