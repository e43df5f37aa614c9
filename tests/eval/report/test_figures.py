"""Curves of tables."""

from pathlib import Path

from eval.report import figures


def test_curves_use_a_logarithmic_axis_where_they_span_a_decade(tmp_path: Path) -> None:
    def scale(values: tuple[float, float]) -> str:
        curve = figures.Curve("a", (20.0, 60.0), values, (0.1, 0.1))
        figure = figures.curves_figure([figures.Panel("one", "clip-FID", (curve,))])
        figures.save(figure, tmp_path / "curves.png")
        return str(figure.axes[0].get_yscale())

    assert scale((1.0, 50.0)) == "log"
    assert scale((1.0, 2.0)) == "linear"
