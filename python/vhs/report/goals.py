"""Sections about the goal store: its images, what prototypes look like, how features of classes lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import torch
from numpy.typing import NDArray

from vhs.acting.policy import Policy
from vhs.distribution import pip_install
from vhs.png import as_picture
from vhs.report.decoder import decode
from vhs.report.page import Section, card, figure, image, legend, missing, shaded
from vhs.report.svg import svg

_A_CLASS = 150
"""Images of a class that are looked at."""
_THUMBNAILS = 9
_NEAREST = 6
_BATCH = 128
_SHAPES = 5
"""Shapes and colours that tell classes apart; a sixth class has those of the first."""


@dataclass(frozen=True, slots=True)
class StoredGoals:
    """A sample of the goal store without repetitions, with features."""

    counts: NDArray[np.int64]
    """Images in the store of each class, shape [classes]."""
    frames: NDArray[np.uint8]
    """Newest frame of each sampled observation, shape [N, height, width, 3]."""
    labels: NDArray[np.int64]
    """Classes, shape [N]."""
    features: NDArray[np.float32]
    """f(o), shape [N, feature_dim]."""
    prototypes: NDArray[np.float32]
    """Shape [classes, feature_dim]."""
    has_prototype: NDArray[np.bool_]
    """Shape [classes]."""
    names: tuple[str, ...]
    """Of the classes, for people."""
    warmup: int
    """Images that the store must hold before running prototypes start."""


def look_at_goals(agent: Policy) -> StoredGoals | None:
    """Sample the goal store and embed what is there; None where the store is empty."""
    store = agent.goals.store
    found = [
        (label, _distinct(store.sample_class(label, 3 * _A_CLASS)))
        for label, n in enumerate(store.counts)
        if n
    ]
    if not found:
        return None
    observations = np.concatenate([images for _, images in found])
    for label, _ in found:
        agent.goals.refresh(label)
    colours = observations.shape[-1] // agent.config.model.frame_stack
    prototypes = agent.goals.prototypes
    return StoredGoals(
        counts=store.counts,
        frames=np.ascontiguousarray(as_picture(observations[..., -colours:])),
        labels=np.concatenate([np.full(len(images), label, dtype=np.int64) for label, images in found]),
        features=_embed(agent, observations),
        prototypes=prototypes.table,
        has_prototype=prototypes.seen,
        names=tuple(agent.task.goal_name(label) for label in range(len(store.counts))),
        warmup=agent.config.method.warmup,
    )


def store_section(goals: StoredGoals | None, why: str) -> Section:
    """Thumbnails of every class."""
    title = "Goal store"
    if goals is None:
        return Section("goals", title, missing(why))
    rows = []
    for label, count in enumerate(goals.counts.tolist()):
        shown = goals.frames[goals.labels == label][:_THUMBNAILS]
        thumbnails = "".join(image(frame, goals.names[label]) for frame in shown) or "none yet"
        rows.append(_class_row(goals, label, f"{count:,} image{'' if count == 1 else 's'}", thumbnails))
    lead = "Final observations of successes, under the goal of their instruction; a random few of each class."
    return Section("goals", title, f'<div class="card">{"".join(rows)}</div>', lead)


def prototype_section(goals: StoredGoals | None, why: str) -> Section:
    """The decoded prototype of each class beside the stored images nearest to it."""
    title = "What a prototype looks like"
    if goals is None:
        return Section("prototypes", title, missing(why))
    labels = np.flatnonzero(goals.has_prototype)
    if not len(labels):
        held = int(goals.counts.sum())
        return Section(
            "prototypes",
            title,
            missing(f"the store holds {held} images and prototypes start at {goals.warmup}"),
        )
    decoded = decode(goals.features, goals.frames, goals.prototypes[labels])
    rows = []
    for label, picture in zip(labels.tolist(), decoded, strict=True):
        nearest, cosines = _nearest(goals, label)
        pictures = figure(picture, "prototype, decoded", "big") + "".join(
            figure(goals.frames[row], f"{goals.names[goals.labels[row]]} {cosine:.3f}")
            for row, cosine in zip(nearest, cosines, strict=True)
        )
        rows.append(_class_row(goals, label, "", pictures))
    lead = (
        "Left: the prototype through a small decoder, trained on the stored images for this page with most "
        "weight on what stands out of their mean. Right: the stored images whose features are nearest to it, "
        "of whatever class, with the cosine."
    )
    return Section("prototypes", title, f'<div class="card">{"".join(rows)}</div>', lead)


def feature_section(goals: StoredGoals | None, why: str) -> Section:
    """t-SNE of the features of stored images, prototypes among them."""
    title = "Features of goals"
    if goals is None:
        return Section("features", title, missing(why))
    if len(goals.features) < 10:
        return Section("features", title, missing(f"t-SNE of {len(goals.features)} images would say nothing"))
    try:
        from sklearn.manifold import TSNE
    except ImportError:
        return Section("features", title, missing(f"t-SNE needs scikit-learn: {pip_install('report')}"))
    labels = np.flatnonzero(goals.has_prototype)
    points = np.concatenate([goals.features, goals.prototypes[labels]])
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    perplexity = min(30.0, (len(points) - 1) / 3)
    plane = TSNE(2, perplexity=perplexity, init="pca", random_state=0, metric="cosine").fit_transform(points)
    names = [(goals.names[label], f"var(--o{label % _SHAPES})") for label in np.unique(goals.labels).tolist()]
    note = (
        f"{len(goals.features)} stored images; one shape and colour a class; large with a rim: the prototype."
    )
    chart = _scatter(plane, np.concatenate([goals.labels, labels]), goals)
    lead = (
        "f(o) of stored images: what lies together looks alike to the agent. The axes of t-SNE have no unit."
    )
    cards = card("t-SNE", legend(names) + chart, note) + card(
        "Cosine between images of two classes", *_cosines(goals)
    )
    return Section("features", title, f'<div class="grid">{cards}</div>', lead)


def _cosines(goals: StoredGoals) -> tuple[str, str]:
    """A table of mean cosines between features of two classes, and a note."""
    unit = goals.features / np.linalg.norm(goals.features, axis=1, keepdims=True)
    labels = np.unique(goals.labels).tolist()
    means = np.stack([unit[goals.labels == label].mean(axis=0) for label in labels])
    cosines = means @ means.T
    low, span = cosines.min(), max(float(np.ptp(cosines)), 1e-9)
    names = [escape(goals.names[label]) for label in labels]
    rows = (
        f"<tr><th>{name}</th>{''.join(shaded(f'{value:.2f}', (value - low) / span) for value in row)}</tr>"
        for name, row in zip(names, cosines, strict=True)
    )
    head = "".join(f"<th>{name}</th>" for name in names)
    table = (
        f'<table class="matrix"><thead><tr><th></th>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    )
    note = "Mean over all pairs of images; on the diagonal within a class. Dark: alike, relative to the rest."
    return f'<div class="scroll">{table}</div>', note


def _class_row(goals: StoredGoals, label: int, note: str, pictures: str) -> str:
    swatch = f'<span class="swatch" style="background:var(--o{label % _SHAPES})"></span>'
    name = swatch + escape(goals.names[label])
    return (
        f'<div class="class"><div><b>{name}</b><span class="note">{escape(note)}</span></div>'
        f'<div class="row">{pictures}</div></div>'
    )


def _distinct(images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """At most `_A_CLASS` images, none twice: the store samples with replacement."""
    first = {hash(image.tobytes()): row for row, image in reversed(list(enumerate(images)))}
    return images[sorted(first.values())[:_A_CLASS]]


@torch.inference_mode()
def _embed(agent: Policy, observations: NDArray[np.uint8]) -> NDArray[np.float32]:
    """f(o) with running statistics, as when acting."""
    networks = agent.agent.eval()
    device = networks.gate.weight.device
    batches = [
        networks.extractor(torch.from_numpy(observations[at : at + _BATCH]).to(device), agent.dtype)
        for at in range(0, len(observations), _BATCH)
    ]
    features: NDArray[np.float32] = torch.cat(batches).cpu().numpy()
    return features


def _nearest(goals: StoredGoals, label: int) -> tuple[list[int], list[float]]:
    """Rows of the images nearest to a prototype, and their cosines."""
    prototype = goals.prototypes[label]
    lengths = np.linalg.norm(goals.features, axis=1) * np.linalg.norm(prototype)
    cosines = goals.features @ prototype / np.maximum(lengths, 1e-9)
    rows = np.argsort(-cosines)[:_NEAREST]
    return rows.tolist(), cosines[rows].tolist()


def _scatter(plane: NDArray[np.float32], labels: NDArray[np.int64], goals: StoredGoals) -> str:
    """Points of the plane, images first, prototypes after them."""
    width, height, margin = 460.0, 380.0, 14.0
    low, high = plane.min(axis=0), plane.max(axis=0)
    scaled = (plane - low) / np.maximum(high - low, 1e-9) * (width - 2 * margin, height - 2 * margin) + margin
    parts = [
        _marker(int(label), float(x), float(y), goals.names[label], row >= len(goals.features))
        for row, ((x, y), label) in enumerate(zip(scaled, labels, strict=True))
    ]
    return svg(width, height, "t-SNE of goal features", "".join(parts))


def _marker(label: int, x: float, y: float, name: str, is_prototype: bool) -> str:
    shape = _polygon(label % _SHAPES, x, y, 9.0 if is_prototype else 3.4)
    rim = ";stroke:var(--ink);stroke-width:2" if is_prototype else ";fill-opacity:.75"
    tip = quoteattr(f"prototype of {name}" if is_prototype else name)
    return f'<polygon style="fill:var(--o{label % _SHAPES}){rim}" points="{shape}" data-tip={tip}/>'


_CORNERS: Sequence[tuple[int, float, float]] = (
    (12, 0.0, 1.0),
    (4, 45.0, 1.15),
    (3, -90.0, 1.3),
    (4, 0.0, 1.2),
    (3, 90.0, 1.3),
)
"""Shapes that tell classes apart without colour: disc, square, triangle, diamond, triangle upside down."""


def _polygon(kind: int, x: float, y: float, size: float) -> str:
    count, start, scale = _CORNERS[kind]
    angles = np.radians(start + 360.0 * np.arange(count) / count)
    xs, ys = x + scale * size * np.cos(angles), y + scale * size * np.sin(angles)
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(xs, ys, strict=True))
