"""3-D views in Rerun, and layouts for Foxglove and PlotJuggler."""
