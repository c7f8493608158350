"""Whom the edge serves next: five rules, exact queue replay, the slotted optimizer and its theorem."""
