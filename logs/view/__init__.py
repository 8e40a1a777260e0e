"""3-D views: Rerun, and layouts for Foxglove and PlotJuggler."""
