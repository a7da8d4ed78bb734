"""When two answers to one question agree, and when two pictures show the same."""

from __future__ import annotations

DISAGREE = 3.0  # deviations by which two answers to one question may differ
# Normalised correlation from which on two pictures show the same: patches, and what crosses a panorama's seam. For
# patches 0.7 to 0.92 are better here and worse there, but with 0.85 small noisy images lose their tracks
# (docs/lab-notes/constants-2026-11-30.md); what crosses, see
# `images.full_circle`.
ALIKE = 0.8
