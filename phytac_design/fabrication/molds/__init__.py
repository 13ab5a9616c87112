"""Molds for the switches of a design: rigid printed plates, or masters for a silicone mold."""
