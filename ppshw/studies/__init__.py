"""Studies: each a command that makes a table, a picture and the JSON behind both."""
