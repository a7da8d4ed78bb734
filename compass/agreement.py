"""When two answers to one question agree, when two patches show the same, and when corners agree on a motion."""

from __future__ import annotations

# Deviations by which two answers to one question may differ: one in 370 does by chance. With 1.5 and 6 held-out drives
# err as much in the median (docs/lab-notes/halves-and-doubles-2026-11-30.md).
DISAGREE = 3.0
# Normalised correlation from which on two patches show the same: 0.7 to 0.92 are better here and worse there, but with
# 0.85 small noisy images lose their tracks (docs/lab-notes/constants-2026-11-30.md).
ALIKE = 0.8
# Of the corners must be found again, and be inliers, to be taken for all of them: for what is sought near by, for a
# motion that goes on, and for a turn without travel. With 0.8, 0.9 and 0.95 increments of six tuned drives err by
# 0.0055, 0.0048 and 0.0048 deg RMS, in 2.3, 2.7 and 2.9 ms.
AGREE = 0.9
