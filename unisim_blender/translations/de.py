"""German texts of the interface, by the English ones."""

GERMAN: dict[str, str] = {
    '"{name}" no longer exists': "„{name}“ existiert nicht mehr",
    ", {rate:.2f} frames/s": ", {rate:.2f} Frames/s",
    "A GPU if the interpreter supports one, otherwise the CPU": (
        "Eine GPU, falls der Interpreter eine unterstützt, sonst die CPU"
    ),
    "Active Camera": "Aktive Kamera",
    "Actor": "Akteur",
    "Actor of a Trained Scene": "Akteur einer trainierten Szene",
    "Actor that each pixel shows": "Akteur, den jedes Pixel zeigt",
    "Actor whose appearance is used": "Akteur, dessen Aussehen verwendet wird",
    "Actors": "Akteure",
    "Actors duplicated: {count}": "Akteure dupliziert: {count}",
    "Actors: {actors}, sensors: {sensors}": "Akteure: {actors}, Sensoren: {sensors}",
    "Add Camera": "Kamera hinzufügen",
    "Add LiDAR": "LiDAR hinzufügen",
    "Add a LiDAR to the vehicle": "Dem Fahrzeug ein LiDAR hinzufügen",
    "Add a camera to the vehicle and make it the active camera": "Dem Fahrzeug eine Kamera hinzufügen und sie aktivieren",
    "Aim Sensor": "Sensor ausrichten",
    "All Sensors": "Alle Sensoren",
    "All cameras and LiDARs of the scene": "Alle Kameras und LiDARs der Szene",
    "Along world X or Y, whichever the object is longer in": "Entlang X oder Y der Welt, wo das Objekt länger ist",
    "Another task is running: cancel it or wait until it ends": ("Eine andere Aufgabe läuft: abbrechen oder ihr Ende abwarten"),
    "Appearance": "Aussehen",
    "Apple GPU": "Apple-GPU",
    "Apply Rig Preset": "Rig-Preset anwenden",
    "At the 3D cursor": "Am 3D-Cursor",
    "At the 3D cursor in the current frame, on the same trajectory": (
        "Im aktuellen Frame am 3D-Cursor, auf derselben Trajektorie"
    ),
    "At the location of the source, to be moved with Blender's tools": "Am Ort der Quelle, zum Verschieben mit Blender",
    "Attribute that colours LiDAR points": "Attribut, nach dem LiDAR-Punkte gefärbt werden",
    "Automatic": "Automatisch",
    "Balanced": "Ausgewogen",
    "Beam table": "Strahlentabelle",
    "Beams": "Strahlen",
    "Beside, left": "Daneben, links",
    "Beside, right": "Daneben, rechts",
    "Blender runs as a Python module, which has no animation player": (
        "Blender läuft als Python-Modul, das keinen Animationsplayer hat"
    ),
    "Box": "Quader",
    "Camera": "Kamera",
    "Camera names separated by commas, or all": "Kameranamen durch Kommas getrennt, oder all",
    "Camera on the Vehicle": "Kamera am Fahrzeug",
    "Camera whose images are played": "Kamera, deren Bilder abgespielt werden",
    "Cameras": "Kameras",
    "Cancel": "Abbrechen",
    "Change Beams": "Strahlen ändern",
    "Change the beam table of the selected LiDARs": "Die Strahlentabelle der ausgewählten LiDARs ändern",
    "Change the speed between two times; later keyframes shift accordingly": (
        "Die Geschwindigkeit zwischen zwei Zeiten ändern; spätere Keyframes verschieben sich entsprechend"
    ),
    "Change the speed from the current frame on": "Die Geschwindigkeit ab dem aktuellen Frame ändern",
    "Change when the selected actors are where on their trajectories": (
        "Ändern, wann die ausgewählten Akteure wo auf ihren Trajektorien sind"
    ),
    "Check": "Prüfung",
    "Check Edits": "Änderungen prüfen",
    "Class": "Klasse",
    "Class name as in the labels of the log, for example Car, Pedestrian or Cones": (
        "Klassenname wie in den Labels des Logs, zum Beispiel Car, Pedestrian oder Cones"
    ),
    "Clear Filter": "Filter zurücksetzen",
    "Colour": "Farbe",
    "Colour by": "Färben nach",
    "Colours are already shown as recorded": "Farben werden schon wie aufgezeichnet gezeigt",
    "Columns": "Spalten",
    "Compare with Shown Variant": "Mit gezeigter Variante vergleichen",
    "Contact shadows": "Kontaktschatten",
    "Contains": "Inhalt",
    "Copy Static Item": "Statisches Objekt kopieren",
    "Copy the selected static items to the 3D cursor": "Die ausgewählten statischen Objekte an den 3D-Cursor kopieren",
    "Custom": "Eigene",
    "Custom elevation angles": "Eigene Elevationswinkel",
    "Delay": "Verzögern",
    "Delay or duration of the stop, in seconds of the log": "Verzögerung oder Dauer des Halts, in Sekunden des Logs",
    "Delay the whole trajectory": "Die ganze Trajektorie verzögern",
    "Delete": "Löschen",
    "Delete Actor": "Akteur löschen",
    "Delete Variant": "Variante löschen",
    "Delete the selected actors and static items from all images and sweeps": (
        "Die ausgewählten Akteure und statischen Objekte aus allen Bildern und Sweeps löschen"
    ),
    "Depth": "Tiefe",
    "Device": "Gerät",
    "Device that the renderer uses": "Gerät, das der Renderer verwendet",
    "Displace Trajectory": "Trajektorie verschieben",
    "Displace the trajectory of the ego vehicle and its sensors to the left or right": (
        "Die Trajektorie des Ego-Fahrzeugs mit seinen Sensoren nach links oder rechts verschieben"
    ),
    "Displacement to the left; negative values displace to the right": (
        "Verschiebung nach links; negative Werte verschieben nach rechts"
    ),
    "Distance": "Abstand",
    "Distance along each ray and along the optical axis": "Abstand entlang jedes Strahls und entlang der optischen Achse",
    "Distance from the sensor, from blue to red (80 m)": "Abstand vom Sensor, von Blau bis Rot (80 m)",
    "Distance to the next lane": "Abstand zur nächsten Spur",
    "Done: {progress}": "Fertig: {progress}",
    "Draw trajectories of the selected actors with their speed, and the recorded trajectories": (
        "Trajektorien der ausgewählten Akteure mit ihrer Geschwindigkeit zeichnen, dazu die aufgezeichneten"
    ),
    "Drive": "Fahrt",
    "Driving Log (folder)": "Fahrtlog (Ordner)",
    "Duplicate": "Duplizieren",
    "Duplicate Actor": "Akteur duplizieren",
    "Duplicate the selected actors with their trajectories": "Die ausgewählten Akteure mit ihren Trajektorien duplizieren",
    "Edited since the check": "Seit der Prüfung geändert",
    "Edits": "Änderungen",
    "Ego": "Ego",
    "Elevation angles of custom beams in degrees, separated by commas": (
        "Elevationswinkel eigener Strahlen in Grad, durch Kommas getrennt"
    ),
    "Elevations": "Elevationen",
    "End time, in seconds of the log": "Endzeit, in Sekunden des Logs",
    "Every pixel is traced individually, in steps of centimetres": (
        "Jedes Pixel wird einzeln verfolgt, in Schritten von Zentimetern"
    ),
    "Export Scenario": "Szenario exportieren",
    "Export Variants": "Varianten exportieren",
    "Factor of the original speed": "Faktor der ursprünglichen Geschwindigkeit",
    "Fast": "Schnell",
    "Find an interpreter that can render and show its capabilities": (
        "Einen Interpreter suchen, der rendern kann, und seine Fähigkeiten zeigen"
    ),
    "Fine": "Fein",
    "Firings per revolution of custom beams": "Schüsse je Umdrehung eigener Strahlen",
    "Folder": "Ordner",
    "Folder of the trained scene": "Ordner der trainierten Szene",
    "Folder of the trained scene; empty for the one of the drive": "Ordner der trainierten Szene; leer für die der Fahrt",
    "Follow Curve": "Kurve folgen",
    "Forward direction of the object": "Vorwärtsrichtung des Objekts",
    "Frames as START:STOP:STEP": "Frames als START:STOP:SCHRITT",
    "From": "Von",
    "From ({first:g} s) must be earlier than To ({last:g} s)": "Von ({first:g} s) muss vor Bis ({last:g} s) liegen",
    "From blue (low) to yellow (high)": "Von Blau (niedrig) bis Gelb (hoch)",
    "Go to Edit": "Zur Änderung gehen",
    "Go to Warning": "Zur Warnung gehen",
    "Go to the frame of a warning, select its object and show it": (
        "Zum Frame einer Warnung gehen, ihr Objekt auswählen und zeigen"
    ),
    "Height": "Höhe",
    "Hide Actor in the View": "Akteur in der Ansicht ausblenden",
    "Horizontal FOV": "Horizontales Sichtfeld",
    "Horizontal field of view in degrees": "Horizontales Sichtfeld in Grad",
    "Image height": "Bildhöhe",
    "Image width": "Bildbreite",
    "Image width in pixels; 0 for the recorded width": "Bildbreite in Pixeln; 0 für die aufgezeichnete Breite",
    "Image width of sequences in pixels; 0 for the width of each camera": (
        "Bildbreite von Sequenzen in Pixeln; 0 für die Breite jeder Kamera"
    ),
    "Images: {count}": "Bilder: {count}",
    "Import Driving Log": "Fahrtlog importieren",
    "Import Scenario": "Szenario importieren",
    "Import Trained Neural Scene": "Trainierte neuronale Szene importieren",
    "Import Trained Scene": "Trainierte Szene importieren",
    "Import a drive first: there is no ego vehicle": "Zuerst eine Fahrt importieren: es gibt kein Ego-Fahrzeug",
    "Import a driving log or a trained scene first": "Zuerst ein Fahrtlog oder eine trainierte Szene importieren",
    "Import a trained neural scene and its drive, with refined tracklets": (
        "Eine trainierte neuronale Szene und ihre Fahrt importieren, mit verfeinerten Tracklets"
    ),
    "Import cancelled: the scene is unchanged": "Import abgebrochen: die Szene ist unverändert",
    "Import into UniSim": "In UniSim importieren",
    "Import or train a trained scene first": "Zuerst eine Szene importieren oder trainieren",
    "Import the drive of a scenario with all its edits": "Die Fahrt eines Szenarios mit allen Änderungen importieren",
    "Import the scenario, trained scene, log or rig preset that a dropped file belongs to": (
        "Szenario, trainierte Szene, Log oder Rig-Preset importieren, wozu eine abgelegte Datei gehört"
    ),
    "Import the vehicle, sensors and actors of a recorded drive as animated objects": (
        "Fahrzeug, Sensoren und Akteure einer aufgezeichneten Fahrt als animierte Objekte importieren"
    ),
    "Importing {what}: {done} of {total} (Esc to cancel)": "Importiere {what}: {done} von {total} (Esc bricht ab)",
    "In place": "An Ort und Stelle",
    "Insert": "Einfügen",
    "Insert Actor": "Akteur einfügen",
    "Insert an actor of the drive or of a trained scene at the 3D cursor": (
        "Einen Akteur der Fahrt oder einer trainierten Szene am 3D-Cursor einfügen"
    ),
    "Insert from Another Scene": "Aus anderer Szene einfügen",
    "Instance": "Instanz",
    "Intensity": "Intensität",
    "Item": "Objekt",
    "Kind of time change": "Art der zeitlichen Änderung",
    "Lane width": "Spurbreite",
    "Left": "Links",
    "Left of the source with a gap of 0.6 m": "Links der Quelle mit 0,6 m Abstand",
    "LiDAR Points": "LiDAR-Punkte",
    "LiDAR on the Vehicle": "LiDAR am Fahrzeug",
    "Library written to {path} (actors: {count})": "Bibliothek nach {path} geschrieben (Akteure: {count})",
    "List implausible edits: overlaps, sideways or too fast cars, actors off the ground, far or unseen camera views": (
        "Unplausible Änderungen auflisten: Überlappungen, quer oder zu schnell fahrende Autos, Akteure nicht "
        "am Boden, entfernte oder nie aufgezeichnete Ansichten"
    ),
    "Location of the copies": "Ort der Kopien",
    "Long steps, and fewer pixels traced individually": "Lange Schritte, und weniger Pixel einzeln verfolgt",
    "Longest Axis": "Längste Achse",
    "Look Through Camera": "Durch Kamera blicken",
    "Look through this camera and use its image size": "Durch diese Kamera blicken und ihre Bildgröße verwenden",
    "Make Actor Library": "Akteurbibliothek erstellen",
    "Mark Static Item": "Statisches Objekt markieren",
    "Mark a static item: the bounding box of the selected active mesh, or a new box at the 3D cursor": (
        "Ein statisches Objekt markieren: den Begrenzungsquader des ausgewählten aktiven Meshs oder einen neuen am 3D-Cursor"
    ),
    "Maximum range of custom beams": "Größte Reichweite eigener Strahlen",
    "Mesh actors keep their own appearance: select recorded actors only": (
        "Mesh-Akteure behalten ihr Aussehen: nur aufgezeichnete Akteure auswählen"
    ),
    "Mesh actors: {count}": "Mesh-Akteure: {count}",
    "Minutes": "Minuten",
    "Mode": "Modus",
    "Model configuration": "Modellkonfiguration",
    "Motion": "Bewegung",
    "Mount": "Montageort",
    "Move the selected actors along the selected curve at a constant speed, from the current frame on": (
        "Die ausgewählten Akteure ab dem aktuellen Frame mit konstanter Geschwindigkeit entlang der ausgewählten Kurve bewegen"
    ),
    "Mute Edit": "Änderung stummschalten",
    "NVIDIA GPU": "NVIDIA-GPU",
    "New Variant": "Neue Variante",
    "Next lane, left": "Nächste Spur, links",
    "Next lane, right": "Nächste Spur, rechts",
    "No drive imported": "Keine Fahrt importiert",
    "No task": "Keine Aufgabe",
    "No task is running": "Es läuft keine Aufgabe",
    "No warnings": "Keine Warnungen",
    "None": "Keine",
    "None: everything is as recorded": "Keine: alles ist wie aufgezeichnet",
    "Normal": "Normale",
    "Not checked yet": "Noch nicht geprüft",
    "Not part of a drive": "Nicht Teil einer Fahrt",
    "Objects deleted: {count}": "Objekte gelöscht: {count}",
    "Offset of the recorded LiDAR points to the left of the vehicle, for comparison with simulated points": (
        "Versatz der aufgezeichneten LiDAR-Punkte nach links vom Fahrzeug, zum Vergleich mit simulierten Punkten"
    ),
    "One colour per actor; recorded points are coloured by class": (
        "Eine Farbe je Akteur; aufgezeichnete Punkte werden nach Klasse gefärbt"
    ),
    "One lane to the left": "Eine Spur nach links",
    "One lane to the right": "Eine Spur nach rechts",
    "Only the active camera of the scene": "Nur die aktive Kamera der Szene",
    "Opacity": "Deckkraft",
    "Opacity of everything nearer than the background model": ("Deckkraft von allem, was näher als das Hintergrundmodell ist"),
    "Opacity pass": "Deckkraft-Pass",
    "Open Folder": "Ordner öffnen",
    "Open Presets Folder": "Preset-Ordner öffnen",
    "Opening the drive (Esc to cancel)": "Fahrt wird geöffnet (Esc bricht ab)",
    "Open the output folder in the system's file browser": "Den Ausgabeordner im Dateibrowser des Systems öffnen",
    "Output": "Ausgabe",
    "Output folder of sequences": "Ausgabeordner von Sequenzen",
    "Passes": "Passes",
    "Passes and Effects": "Passes und Effekte",
    "Passes that a sequence contains in addition to colours": "Passes, die eine Sequenz außer den Farben enthält",
    "Path of the .blend file, in a folder listed in Preferences > File Paths > Asset Libraries": (
        "Pfad der .blend-Datei, in einem Ordner aus Einstellungen > Dateipfade > Asset-Bibliotheken"
    ),
    "Pitch": "Nicken",
    "Pixels that no recorded data supports": "Pixel, die keine aufgezeichneten Daten stützen",
    "Place the selected actors and static items on the ground below them, at the current frame": (
        "Die ausgewählten Akteure und statischen Objekte im aktuellen Frame auf den Boden unter ihnen setzen"
    ),
    "Play Result": "Ergebnis abspielen",
    "Play the rendered images of a camera in Blender's animation player": (
        "Die gerenderten Bilder einer Kamera in Blenders Animationsplayer abspielen"
    ),
    "Points along": "Zeigt entlang",
    "Position in the frame of the vehicle": "Position im Koordinatensystem des Fahrzeugs",
    "Presence Timeline": "Anwesenheitsleiste",
    "Present": "Anwesend",
    "Preview {number} of {count}": "Vorschau {number} von {count}",
    "Python interpreter with torch, for training and GPU rendering; Blender's own renders on the CPU if empty": (
        "Python-Interpreter mit torch, für Training und Rendern auf der GPU; leer rendert Blenders eigener auf der CPU"
    ),
    "Quality": "Qualität",
    "Range": "Reichweite",
    "Reading the scene": "Szene wird gelesen",
    "Reading {scene}: {done} of {total} (Esc to cancel)": "{scene} wird gelesen: {done} von {total} (Esc bricht ab)",
    "Recorded": "Aufgezeichnet",
    "Recorded Offset": "Versatz der aufgezeichneten",
    "Recorded points": "Aufgezeichnete Punkte",
    "Recorded points are yellow, simulated points blue": "Aufgezeichnete Punkte sind gelb, simulierte blau",
    "Reference": "Referenz",
    "Release Ego Body": "Ego-Karosserie freigeben",
    "Release Mesh Actor": "Mesh-Akteur freigeben",
    "Remove Rig Preset": "Rig-Preset entfernen",
    "Remove the marks of the selected static items; the scene itself stays unchanged": (
        "Die Markierungen der ausgewählten statischen Objekte entfernen; die Szene selbst bleibt unverändert"
    ),
    "Rename Variant": "Variante umbenennen",
    "Render Sequence": "Sequenz rendern",
    "Render Variants": "Varianten rendern",
    "Render on a GPU with CUDA": "Auf einer GPU mit CUDA rendern",
    "Render on a GPU with Metal": "Auf einer GPU mit Metal rendern",
    "Render on the CPU": "Auf der CPU rendern",
    "Render the sensors over the frame range into the output folder, in the background; finished frames are kept": (
        "Die Sensoren über den Framebereich im Hintergrund in den Ausgabeordner rendern; fertige Frames bleiben erhalten"
    ),
    "Renderer's Python": "Python des Renderers",
    "Rendering": "Rendert",
    "Rendering runs on the CPU; training and GPU rendering need an interpreter with torch, named above": (
        "Gerendert wird auf der CPU; Training und Rendern auf der GPU brauchen einen Interpreter mit torch, oben anzugeben"
    ),
    "Renders with {path}": "Rendert mit {path}",
    "Replace Appearance": "Aussehen ersetzen",
    "Replace the appearance and the box of the selected actors by those of another actor, on the same trajectory": (
        "Aussehen und Quader der ausgewählten Akteure durch die eines anderen ersetzen, auf derselben Trajektorie"
    ),
    "Restore Recorded Sensors": "Aufgezeichnete Sensoren wiederherstellen",
    "Retime": "Zeit ändern",
    "Retime Actor": "Zeit des Akteurs ändern",
    "Revert Edit": "Änderung zurücknehmen",
    "Rig Presets": "Rig-Presets",
    "Right of the source with a gap of 0.6 m": "Rechts der Quelle mit 0,6 m Abstand",
    "Rotation to the left in degrees": "Drehung nach links in Grad",
    "Rotation upwards in degrees": "Drehung nach oben in Grad",
    "Sampling": "Abtastung",
    "Sampling density along rays": "Abtastdichte entlang der Strahlen",
    "Save Rig Preset": "Rig-Preset speichern",
    "Save the .blend first, or choose a folder that does not depend on it": (
        "Zuerst die .blend-Datei speichern oder einen Ordner wählen, der nicht von ihr abhängt"
    ),
    "Scenario written to {path} (edits: {count})": "Szenario nach {path} geschrieben (Änderungen: {count})",
    "Scene": "Szene",
    "Scroll Presence Timeline": "Anwesenheitsleiste rollen",
    "Searching…": "Suche …",
    "Seconds": "Sekunden",
    "Select Actor": "Akteur auswählen",
    "Select Listed": "Gelistete auswählen",
    "Select a LiDAR first": "Zuerst ein LiDAR auswählen",
    "Select a mesh actor first": "Zuerst einen Mesh-Akteur auswählen",
    "Select a mesh object that is not part of the drive yet": ("Ein Mesh-Objekt auswählen, das noch nicht Teil der Fahrt ist"),
    "Select a static item first": "Zuerst ein statisches Objekt auswählen",
    "Select an actor first": "Zuerst einen Akteur auswählen",
    "Select an actor or a static item first": "Zuerst einen Akteur oder ein statisches Objekt auswählen",
    "Select one curve in addition to the actors (Add > Curve)": "Zu den Akteuren eine Kurve auswählen (Hinzufügen > Kurve)",
    "Selected Sensors": "Ausgewählte Sensoren",
    "Sensor": "Sensor",
    "Sensors": "Sensoren",
    "Sensors that a sequence renders": "Sensoren, die eine Sequenz rendert",
    "Set an output folder first: UniSim > Output > Folder": "Zuerst einen Ausgabeordner angeben: UniSim > Ausgabe > Ordner",
    "Shift Actor": "Akteur verschieben",
    "Shift Ego Lane": "Ego-Spur verschieben",
    "Show": "Anzeigen",
    "Show Colours as Recorded": "Farben wie aufgezeichnet",
    "Show LiDAR Points": "LiDAR-Punkte anzeigen",
    "Show Variant": "Variante zeigen",
    "Show cameras, LiDARs and the axes of the ego vehicle in views that do not look through a sensor": (
        "Kameras, LiDARs und die Achsen des Ego-Fahrzeugs in Ansichten zeigen, die nicht durch einen Sensor blicken"
    ),
    "Show colours as recorded: view transform Standard, look None, exposure 0, gamma 1": (
        "Farben wie aufgezeichnet zeigen: Ansichtstransformation Standard, Look None, Belichtung 0, Gamma 1"
    ),
    "Show or Hide Sensor": "Sensor ein- oder ausblenden",
    "Show recorded LiDAR points, simulated LiDAR points, or both": (
        "Aufgezeichnete LiDAR-Punkte, simulierte oder beide anzeigen"
    ),
    "Show recorded points": "Aufgezeichnete Punkte anzeigen",
    "Show simulated LiDAR points of the current frame": "Simulierte LiDAR-Punkte des aktuellen Frames anzeigen",
    "Show simulated points": "Simulierte Punkte anzeigen",
    "Show the recorded LiDAR points of the current frame": "Aufgezeichnete LiDAR-Punkte des aktuellen Frames anzeigen",
    "Similar pixels are traced together": "Ähnliche Pixel werden gemeinsam verfolgt",
    "Simulated": "Simuliert",
    "Simulated points": "Simulierte Punkte",
    "Single": "Einzelne",
    "Size": "Größe",
    "Size of the new box": "Größe des neuen Quaders",
    "Slow: four times the number of samples of the scene": "Langsam: viermal so viele Abtastpunkte wie die Szene",
    "Snap to Ground": "Auf den Boden setzen",
    "Soft shadows under copied and inserted actors": "Weiche Schatten unter kopierten und eingefügten Akteuren",
    "Sort by": "Sortieren nach",
    "Speed": "Geschwindigkeit",
    "Speed Graph": "Geschwindigkeitskurve",
    "Speed along the curve": "Geschwindigkeit entlang der Kurve",
    "Start time, in seconds of the log": "Startzeit, in Sekunden des Logs",
    "Static Items": "Statische Objekte",
    "Stop and go": "Halten und weiterfahren",
    "Stop at the current frame, then continue": "Am aktuellen Frame halten, dann weiterfahren",
    "Stop the background task; finished frames are kept, and starting it again resumes": (
        "Die Hintergrundaufgabe anhalten; fertige Frames bleiben erhalten, ein neuer Start setzt fort"
    ),
    "Stopped at {progress}; start it again to resume": "Angehalten bei {progress}; erneut starten setzt fort",
    "Stopping: {progress}": "Hält an: {progress}",
    "Stretch": "Strecken",
    "Surface normals in world space": "Oberflächennormalen im Weltkoordinatensystem",
    "Switch to Object Mode first (Tab)": "Zuerst in den Objektmodus wechseln (Tab)",
    "Test Renderer": "Renderer testen",
    "The object points along world -X": "Das Objekt zeigt entlang -X der Welt",
    "The object points along world -Y": "Das Objekt zeigt entlang -Y der Welt",
    "The object points along world X": "Das Objekt zeigt entlang X der Welt",
    "The object points along world Y": "Das Objekt zeigt entlang Y der Welt",
    "The output folder does not exist yet: render first": "Der Ausgabeordner existiert noch nicht: zuerst rendern",
    "The output folder has no camera images yet: render a sequence first": (
        "Der Ausgabeordner enthält noch keine Kamerabilder: zuerst eine Sequenz rendern"
    ),
    "The same edits": "Dieselben Änderungen",
    "The selected cameras and LiDARs": "Die ausgewählten Kameras und LiDARs",
    "The test failed": "Der Test ist fehlgeschlagen",
    "To": "Bis",
    "Train Neural Scene": "Neuronale Szene trainieren",
    "Train a neural scene on the imported log, in the background; an unfinished training in the folder is resumed": (
        "Eine neuronale Szene mit dem importierten Log im Hintergrund trainieren; ein unfertiges im Ordner wird fortgesetzt"
    ),
    "Trained Neural Scene (scene.json)": "Trainierte neuronale Szene (scene.json)",
    "Trained scene": "Trainierte Szene",
    "Training and Assets": "Training und Assets",
    "Training time in minutes": "Trainingszeit in Minuten",
    "Trajectories": "Trajektorien",
    "Turn the selected mesh actors back into ordinary objects, which no sensor sees": (
        "Die ausgewählten Mesh-Akteure wieder zu gewöhnlichen Objekten machen, die kein Sensor sieht"
    ),
    "UniSim Scenario (.json)": "UniSim-Szenario (.json)",
    "Unmark Static Item": "Markierung des statischen Objekts entfernen",
    "Unsupported": "Nicht gestützt",
    "Use Mesh as Actor": "Mesh als Akteur verwenden",
    "Use as Ego Body": "Als Ego-Karosserie verwenden",
    "Use the selected mesh objects and their children as actors, which cameras and LiDARs see": (
        "Die ausgewählten Mesh-Objekte und ihre Kinder als Akteure verwenden, die Kameras und LiDARs sehen"
    ),
    "Variants": "Varianten",
    "Warnings": "Warnungen",
    "Warnings: {count}": "Warnungen: {count}",
    "Where": "Wohin",
    "Width": "Breite",
    "Write the actors of the trained scene to a .blend file of assets": (
        "Die Akteure der trainierten Szene als Assets in eine .blend-Datei schreiben"
    ),
    "Write the edits of the scene to a scenario file for the command unisim render": (
        "Die Änderungen der Szene in eine Szenariodatei für den Befehl unisim render schreiben"
    ),
    "Yaw": "Gieren",
    'camera "{name}" has no images in the output folder': "Kamera „{name}“ hat keine Bilder im Ausgabeordner",
    "choose an actor by its thumbnail first": "zuerst einen Akteur an seinem Bild auswählen",
    'curve "{name}" has fewer than two points': "Kurve „{name}“ hat weniger als zwei Punkte",
    "no active actor": "kein aktiver Akteur",
    "no selected object has a surface": "kein ausgewähltes Objekt hat eine Oberfläche",
    "unsaved file": "ungespeicherte Datei",
    "{done:.1f} of {total:.1f} minutes": "{done:.1f} von {total:.1f} Minuten",
    "{done} of {total} frames": "{done} von {total} Frames",
    '{folder}: has no actor "{name}"': "{folder}: hat keinen Akteur „{name}“",
    "{folder}: save the .blend first, or choose a folder that does not depend on it": (
        "{folder}: zuerst die .blend-Datei speichern oder einen Ordner wählen, der nicht von ihr abhängt"
    ),
    "{name}: its mount is changed": "{name}: die Montage ist geändert",
    "{name}: the change is keyed at frame {frame} and blends in from {blend:g} s before to {blend:g} s after it": (
        "{name}: die Änderung hat einen Key bei Frame {frame} und wird von {blend:g} s davor bis {blend:g} s danach überblendet"
    ),
    "{name}: the ground height is unknown there": "{name}: die Höhe des Bodens ist dort unbekannt",
    "{name}: the scale changes at all its keys": "{name}: die Skalierung ändert sich an allen Keys",
    "{name}: the whole trajectory and its keys are displaced": ("{name}: die ganze Trajektorie mit ihren Keys ist verschoben"),
    "{name}: the whole trajectory is displaced": "{name}: die ganze Trajektorie ist verschoben",
    "{progress}, starting": "{progress}, startet",
    "{progress}, {time} left": "{progress}, noch {time}",
    "{text} (Esc to cancel)": "{text} (Esc bricht ab)",
}
