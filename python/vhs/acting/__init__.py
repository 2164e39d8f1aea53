"""Acting: environments that are stepped, the episodes in them, and the policy that acts."""
