"""Process forces from material, feed and path: stock, engagement, and one module for each force model."""
