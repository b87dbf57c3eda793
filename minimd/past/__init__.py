"""Steps of finished runs, made again: the past of a run in fixed point, its archive, the replay of a failed run."""
