"""Cell tracks from other programs: reads them, and estimates the cells' speeds and responses."""
