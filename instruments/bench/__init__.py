"""The one simulated laboratory: lamp, door, sample and camera. No driver imports it."""
