"""How tracking begins: whose hull, which body, which first pose."""
