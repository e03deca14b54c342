"""A camera's intrinsics: worked out from views, chosen, announced."""
