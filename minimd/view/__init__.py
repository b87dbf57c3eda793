"""A run as a page in the browser: its report, its pictures, and its atoms in motion."""

from minimd.view.viewing import View, view

__all__ = ["View", "view"]
