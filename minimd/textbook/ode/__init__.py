"""Problems, drivers and implicit methods for small systems of ordinary differential equations."""
