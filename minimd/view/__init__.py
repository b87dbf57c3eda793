"""A run as a page for the browser: its report, its pictures, its atoms in motion."""

from minimd.view.viewing import View, view, view_record

__all__ = ["View", "view", "view_record"]
