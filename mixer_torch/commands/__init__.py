"""What the commands of ``mixer`` do: a signature is a schema, and the text returned is printed."""
