"""Links that touch in many poses, described in words."""

from collections import Counter
from collections.abc import Sequence


def shares(contacts: Sequence[set[str]]) -> list[tuple[str, float]]:
    """Return every pair that touches with the share of the poses in which it does, the most first.

    Args:
        contacts: The pairs of each pose.
    """
    counts = Counter(pair for pairs in contacts for pair in pairs)
    return [(pair, count / len(contacts)) for pair, count in counts.most_common()]


def always_colliding(contacts: Sequence[set[str]]) -> str:
    """Say what touches in poses none of which is free, and what to do."""
    touching = shares(contacts)
    often = [pair for pair in touching if pair[1] > 0.5] or touching[:3]
    pairs = "; ".join(f"{pair} touch in {share:.0%}" for pair, share in often)
    return f"no random pose is free of collisions: {pairs}; add links to collision_exempt or change rest"
