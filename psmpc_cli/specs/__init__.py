"""Robot and task descriptions: YAML text to frozen, validated data."""
