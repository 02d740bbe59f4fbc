"""One experiment is one YAML file."""
