"""The main job on public measured data, as a user would do it: models, channel maps, pages."""
