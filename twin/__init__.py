"""The twin service. Nothing is here yet."""
