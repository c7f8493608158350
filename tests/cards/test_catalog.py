"""Every card is found and says what it is."""

from ovibjax.cards.catalog import card_names, cards_folder, load_card


def test_every_card_loads_and_says_what_it_is() -> None:
    assert "scalable_compression" in card_names()
    for name in card_names():
        card = load_card(cards_folder() / f"{name}.py")
        assert card.TITLE and callable(card.run)
