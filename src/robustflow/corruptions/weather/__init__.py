"""The "weather" family of corruptions: spatter, fog, frost and snow."""
