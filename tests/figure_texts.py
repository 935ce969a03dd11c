"""Texts of a drawn figure."""

from itertools import combinations

from matplotlib.backends.backend_agg import FigureCanvasAgg


def require_readable(figure, panels, others, least):
    """Texts of panels, and ``others``, more than ``least``, neither overlap nor leave the figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    texts = [*others]
    for axes in panels:
        texts += [axes._left_title, axes.xaxis.label, axes.yaxis.label, *axes.texts]
        texts += [] if axes.get_legend() is None else axes.get_legend().get_texts()
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_view_interval()
            ticks = axis.get_major_ticks()
            texts += [t.label1 for t in ticks if low <= t.get_loc() <= high and t.label1.get_visible()]
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in texts if t.get_text() and t.get_visible()]
    assert len(boxes) > least
    for (a, first), (b, second) in combinations(boxes, 2):
        assert not first.overlaps(second), (a, b)
    for text, box in boxes:
        assert box.x0 >= 0.0, text
        assert box.y0 >= 0.0, text
        assert box.x1 <= figure.bbox.x1, text
        assert box.y1 <= figure.bbox.y1, text
