"""The server: who may speak to it, routes, the WebSocket, and how it is started."""
