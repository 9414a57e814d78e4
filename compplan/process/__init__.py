"""Process forces that know material, feed and path: stock, engagement, and one file a force model."""
