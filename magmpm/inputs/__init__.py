"""Reading files: settings, quantities, tables, and messages about what is wrong in them."""
