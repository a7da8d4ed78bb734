"""Which yaws the filter remembers, and which of them it gives up for the next: the slots behind `State.CLONE`."""

from __future__ import annotations

from collections.abc import Iterator

from fusion.record import record, replace
from fusion.state.ekf import CLONES
from fusion.state.gyro_trail import Exposure


@record
class Clone:
    """A remembered yaw.

    Attributes
    ----------
    t_ns : int
        Its time.
    used_ns : int
        When an increment last referred to it.
    reference : bool
        Whether an increment refers to it, or only might.
    exposure : Exposure
        Of the image.
    placed_ns : int
        When its yaw was last given: at its time, or later, where an increment put it.
    doubt : float
        What is unconfirmed of its yaw, rad^2: who turns since then as an increment says is confirmed but for that.
    long_baseline : bool
        Whether it belongs to the last increment from some seconds ago, so that the next one may refer to it.
    """

    t_ns: int
    used_ns: int
    reference: bool
    exposure: Exposure
    placed_ns: int
    long_baseline: bool = False
    doubt: float = 0.0


@record
class Clones:
    """What each slot holds; None: nothing yet."""

    slots: tuple[Clone | None, ...] = (None,) * CLONES

    def __getitem__(self, slot: int) -> Clone | None:
        return self.slots[slot]

    def __iter__(self) -> Iterator[Clone | None]:
        return iter(self.slots)

    def slot_of(self, t_ns: int) -> int | None:
        """Where the clone of this time is."""
        return next((i for i, c in enumerate(self.slots) if c and c.t_ns == t_ns), None)

    def next_slot(self) -> int:
        """Where the next clone goes: where nothing refers, else to that least lately used; far ones come last."""
        for i, c in enumerate(self.slots):
            if not c or not (c.reference or c.long_baseline):
                return i
        return min((c.long_baseline, c.used_ns, i) for i, c in enumerate(self.slots) if c)[2]

    def put(self, slot: int, clone: Clone) -> Clones:
        """With this clone in a slot."""
        return Clones((*self.slots[:slot], clone, *self.slots[slot + 1 :]))

    def used(self, slot: int, t_ns: int) -> Clones:
        """Noted that the clone in a slot is a reference, in use at `t_ns`."""
        clone = self.slots[slot]
        return self.put(slot, replace(clone, used_ns=t_ns, reference=True)) if clone else self

    def placed(self, slot: int, t_ns: int) -> Clones:
        """With the yaw of the clone in a slot given anew at `t_ns`."""
        clone = self.slots[slot]
        return self.put(slot, replace(clone, placed_ns=t_ns)) if clone else self

    def doubted(self, t_ns: int, doubt: float) -> Clones:
        """With so much of the yaw of a time unconfirmed, rad^2."""
        return Clones(tuple(replace(c, doubt=doubt) if c and c.t_ns == t_ns else c for c in self.slots))

    def confirmed(self) -> Clones:
        """With all of them as sure as the yaw is now: nothing is unconfirmed any more."""
        if not any(c and c.doubt for c in self.slots):
            return self
        return Clones(tuple(replace(c, doubt=0.0) if c else None for c in self.slots))

    def doubt(self, t_ns: int) -> float:
        """What is unconfirmed of the yaw of a time, rad^2; nothing that is known of one that is not remembered."""
        return next((c.doubt for c in self.slots if c and c.t_ns == t_ns), 0.0)

    def kept(self, *slots: int) -> Clones:
        """With the clones in these slots, and no others, kept for the next increment from some seconds ago."""
        return Clones(tuple(replace(c, long_baseline=i in slots) if c else None for i, c in enumerate(self.slots)))

    def until(self, t_ns: int, but: int) -> Clones:
        """Without those of later than `t_ns`, except the one in a slot."""
        return Clones(tuple(c if c and (i == but or c.t_ns <= t_ns) else None for i, c in enumerate(self.slots)))
