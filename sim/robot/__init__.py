"""The ground robot that carries the moving landing target."""
