"""What is made of the file of a run: its page with atoms in motion, its pictures, its check."""

from minimd.view.viewing import View as View, view as view
