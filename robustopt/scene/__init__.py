"""The scene: where the held bodies are, and what touches what."""
