"""What every finder takes from a picture: grey values, parts, samples, memory."""
