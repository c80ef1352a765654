"""How right: against exact computation, light transport, real pictures."""
