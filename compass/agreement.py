"""When two answers to one question agree, and when two patches show the same."""

from __future__ import annotations

DISAGREE = 3.0  # deviations by which two answers to one question may differ
# Normalised correlation from which on two patches show the same: 0.7 to 0.92 are better here and worse there, but with
# 0.85 small noisy images lose their tracks (docs/lab-notes/constants-2026-11-30.md).
ALIKE = 0.8
