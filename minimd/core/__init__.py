"""What one run needs, in rings: one step, an engine, a run with its file. It imports nothing else of minimd."""
