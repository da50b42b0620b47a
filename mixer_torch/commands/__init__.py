"""What the commands of ``mixer`` do: a signature is a schema, and what it returns is printed."""
