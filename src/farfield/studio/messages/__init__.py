"""The messages between page and server: frozen dataclasses, from which ``web/src/protocol.ts`` is made."""
