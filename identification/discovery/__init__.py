"""Which physical effect is missing: candidates, their evidence, and the model that has them."""
