"""`motionkit serve`: a trained model for animation tools, over MMCP."""

from typing import Annotated

import typer

from motionkit.cli import console
from motionkit.core.errors import MissingExtraError


def serve(
    run: Annotated[
        str | None, typer.Option(help="Name of the run.", show_default="nano, else the shipped cmu-small")
    ] = None,
    runs: console.RunsFolder = None,
    host: Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0 is every network.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535)] = 8000,
) -> None:
    """Answer animation tools that speak MMCP, such as Proscenium for Blender, at any framerate, until Ctrl-C.

    Needs the extra 'serve'. There is no authentication: leave --host as it is unless the network is yours.

    Example: motionkit serve --port 8000
    """
    try:
        import motionmcp
        import uvicorn  # noqa: F401
    except ImportError:
        raise MissingExtraError("motionmcp-sdk[server]", "serve") from None
    from motionkit.generate.mmcp import ServedModel
    from motionkit.generate.motion import load_model
    from motionkit.training.run import find_run

    place = find_run(run, runs)
    console.stderr.print(f"motionkit: serving {place.name} at http://{host}:{port} (Ctrl-C ends it)")
    served = ServedModel(load_model(place.absolute()), place.name)
    motionmcp.serve(served, host=host, port=port, log_level="warning", title="motionkit")
