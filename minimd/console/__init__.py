"""Where minimd meets its user: words of messages, progress, signals, display. No physics."""
